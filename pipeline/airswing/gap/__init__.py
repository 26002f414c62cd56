"""The gap between simulated and real reports: where, which effect, how far it closes.

The rooms in the order in which data flow (:mod:`airswing.gap.diagnose` calls them so):

* ``noise/``: noise along flights, and the whitening by it;
* ``archive/``: an archive's reports as arrays, with what is inferred about each of them;
* ``effects/``: the catalogue, one file an effect; ``simulation/``: the reports forward, with them;
* ``design/``: the columns: weather's (no one's fault), effects', the nonparametric basis;
* ``sums/``: one pass over the reports, and the algebra on its sums: days and climatology out;
* ``evidence/``: how much the data speak for a candidate: whom, from which day on, where;
* ``held_out/``: what terms explain of weeks that had no part in them;
* ``search/``: which effects are at work; ``scatter/``: what shows in no mean;
* ``closure/``: how sure the closure is, and what effects without a claim could still close;
* ``witness/``: what has no name, in tables and by learned trees; ``taken_off/``: such unknowns
  taken off one after the other, beside names or in their place;
* ``as_sent/``: winds so wrong that they are set right before all else;
* ``checks/``: what the diagnosis rests on; ``result/``: what is said.

``library_threads`` keeps the libraries beneath from starting workers within workers.

Whether it is right on sealed archives: :mod:`airswing.blind_check`.
"""
