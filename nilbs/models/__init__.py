"""Trained methods of characters: fitted, kept in files, queried and scored."""
