"""The page of `nilbs view`: what it shows as arrays, and in `panels` and `page` how viser shows it."""
