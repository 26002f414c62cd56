"""The gap between simulated and real reports: where, which effect, how far it closes.

In the order in which data flow (:mod:`airswing.gap.diagnose` calls them):

* ``archive/``: reports as arrays, with what is inferred about each of them;
* ``effects/``: the catalogue, one file an effect; ``simulation/``: reports with effects;
* ``noise/``: noise along flights and whitening; ``design/``: exogenous regressors, weather;
* ``model/``: the statistical model: candidates, sums, evidence, selection, closure;
* ``distribution/``: what no mean shows: coded values, gross errors, scatter, counts;
* ``checks/``: what the diagnosis rests on; ``result/``: gap.json, gap.nc, effects.yaml.

Equations: docs/gap.md. Whether it is right on sealed archives: :mod:`airswing.blind_check`.
"""
