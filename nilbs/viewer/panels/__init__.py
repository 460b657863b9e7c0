"""Parts of the page, one a file: what can be set, and what is drawn. Only these, `page` and `server` need viser."""
