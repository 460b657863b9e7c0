"""Methods: what each field is made of, and what its training minimises."""
