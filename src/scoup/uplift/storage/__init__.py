"""How region sums are kept: seven bytes an entry, in memory or in a file of records that grows."""
