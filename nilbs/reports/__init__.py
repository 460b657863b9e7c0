"""Results as pages that a browser opens without a network: tables, pictures and a scene to turn, all in one file."""
