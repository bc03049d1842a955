"""How region sums are kept: seven bytes an entry, in memory or in a folder with one file per view."""
