"""The gap between simulated and real reports: where, which effect, how far it closes.

Where to look, in the order in which data flow (:mod:`airswing.gap.diagnose` calls them so):

* what is simulated: ``effects/`` (one file an effect), ``simulate``, ``simulated_reports``,
  ``effects_file``;
* an archive's reports as arrays: ``frame``, ``headings_columns``; what is inferred about each of
  them: ``context``, ``bank``, ``turning``, ``acceleration``;
* noise along flights: ``noise``, ``whitening``;
* the columns: ``weather`` (no one's fault), ``effects/``, ``dictionary`` (no physics), numbered by
  ``layout``; summed in one pass by ``statistics``, aircraft after aircraft by ``pieces``;
* on the sums: days and climatology out (``dayfields``, ``measure``), how far scores scatter
  (``clusters``), how large the background is (``background``);
* which: ``candidates`` weighed (``evidence``, ``evaluate``, ``mixture``, ``sharing``,
  ``changepoint`` for dates, ``swap`` for tails), ranked (``ranking``), searched (``attribute``,
  ``terms``, ``widening``), held against other weeks (``standing``); what shows in no mean:
  ``moments``, ``scatter``;
* where: ``locate``;
* how far: ``closure``, its ``interval`` with what was not named (``leftover``), the share of an
  effect its columns hold (``instrument``, ``reliability``), a cause that is none (``decoy``);
* what is said: ``verdict``, ``alias``, ``folding``, ``testability``, ``summary``; what it rests on:
  ``checks``, ``calibration``, ``claims``;
* whether it is right on sealed archives: ``blind/``.
"""
