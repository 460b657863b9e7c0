"""The benchmark: nilbs beside libraries that query the posed mesh."""
