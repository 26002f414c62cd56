"""Which tables are tried on weeks left out: those near the strongest."""

from types import SimpleNamespace

from airswing.gap.witness import taken_off


def test_a_table_far_behind_the_strongest_is_not_tried(monkeypatch):
    def strongest(bench, ranked, component, fold):
        return next(one for one in ranked if one.component == component)

    monkeypatch.setattr(taken_off, "_of_component", strongest)
    strong = SimpleNamespace(strength=200.0, component="cross")
    near = SimpleNamespace(strength=180.0, component="along")
    far = SimpleNamespace(strength=taken_off.LEAST_EVIDENCE + 1.0, component="along")
    assert taken_off._best(None, [strong, far], None) is strong
    monkeypatch.setattr(taken_off, "field_of", lambda bench, table, fold: table)
    monkeypatch.setattr(taken_off, "explained", lambda bench, table: -table.strength)
    assert taken_off._best(None, [strong, near], None) is near
