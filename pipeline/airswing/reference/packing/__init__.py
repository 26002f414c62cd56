"""Values out of the octets of one GRIB message: octets, the packings, and decoding beside."""
