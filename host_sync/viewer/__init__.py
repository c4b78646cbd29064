"""The viewer: a page on this machine that shows libraries and results in an ordinary browser."""
