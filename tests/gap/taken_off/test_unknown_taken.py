"""Which tables are tried on weeks left out."""

from types import SimpleNamespace

from airswing.gap.taken_off import unknown_taken


def test_a_table_far_behind_the_strongest_is_not_tried(monkeypatch):
    def strongest(bench, ranked, component, fold):
        return next(one for one in ranked if one.component == component)

    monkeypatch.setattr(unknown_taken, "_of_component", strongest)
    strong = SimpleNamespace(strength=200.0, component="cross")
    near = SimpleNamespace(strength=180.0, component="along")
    far = SimpleNamespace(strength=unknown_taken.LEAST_EVIDENCE + 1.0, component="along")
    assert unknown_taken._best(None, [strong, far], None) is strong
    monkeypatch.setattr(unknown_taken, "field_of", lambda bench, table, fold: table)
    monkeypatch.setattr(unknown_taken, "explained", lambda bench, table: -table.strength)
    assert unknown_taken._best(None, [strong, near], None) is near
