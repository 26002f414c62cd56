"""A true atmosphere, and model winds that know it imperfectly, written as GRIB."""
