"""What reads GRIB: octets, sections, fields, values, catalogue."""
