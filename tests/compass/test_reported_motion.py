"""Accounts of a fleet's parts: reports add up, reasons stand side by side."""

from airswing.compass.reported_motion import sum_of_accounts


def test_accounts_of_parts_are_the_account_of_the_fleet():
    parts = [
        {"reports": 40, "why": {"N401": "absent"}},
        {"reports": 2, "own": 1, "why": {"N402": "too_few"}},
        {"reports": 5, "own": 3, "why": {}},
    ]
    whole = {"reports": 47, "own": 4, "why": {"N401": "absent", "N402": "too_few"}}
    assert sum_of_accounts(parts) == whole
    assert sum_of_accounts([]) == {}
