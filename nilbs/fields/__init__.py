"""Fields of posed characters, in torch: one method a file, and one training loop that knows no method."""
