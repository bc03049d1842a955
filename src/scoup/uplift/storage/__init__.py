"""Storage of region sums: seven bytes per entry, in memory or in a folder with one file per view."""
