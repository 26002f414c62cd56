"""A witness beside the dictionary: what shows in the reports and has no name.

``ground`` sums any table
over the reports with everything the reference does taken out, ``null`` draws archives in which
nothing is wrong, ``bench`` puts the real one beside them, ``scan`` weighs, ``jumps`` and
``periods`` tell where tables are cut, ``unknowns`` looks for tables, ``fitted_tables`` fits them,
:mod:`airswing.gap.taken_off` takes them off one after the other.
"""
