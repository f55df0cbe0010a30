"""The player of motions in a browser: what it is told of a sequence, and the page that holds it."""
