"""Unknowns taken off one after the other.

``unknown_taken`` finds the strongest and takes it off, ``table_or_names`` says whether its table
takes the place of names, ``closed_by_table`` how sure it is what it closes, ``remainders`` what is
but a rest of what was told before.
"""
