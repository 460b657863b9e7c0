"""What needs libraries under copyleft or non-commercial licences; nothing else in nilbs imports them."""
