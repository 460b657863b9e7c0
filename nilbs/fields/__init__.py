"""Fields of posed characters, in torch: what methods share, and one training loop for all."""
