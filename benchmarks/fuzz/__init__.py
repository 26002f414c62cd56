"""A campaign of damaged input: what files of every kind do to the package when their octets lie."""
