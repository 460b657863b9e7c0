"""Contacts: points that penetrate a posed body, places where two bodies meet, and where one meets itself."""
