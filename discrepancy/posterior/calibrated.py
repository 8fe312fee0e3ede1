"""The numbers of the inference, each with its reason.

`castor-diagnose trial` judges them together: rates, reliability diagram, expected calibration error. Noise of contacts
and trackers is stated where logs are linearised, tolerances of robots in each effect class.
"""

import numpy as np
from scipy.special import logit

CREDIBLE = 0.95
"""Least probability of a credible set. Its odds (19) are also the likelihood ratio that held-out logs must reach to
confirm a name. The field's convention; nothing was fitted to it."""

LOG_ODDS = float(logit(CREDIBLE))
"""`CREDIBLE` as the natural logarithm of odds."""

NOTHING = 0.8
"""Prior probability that a single effect of the sum is absent. Twice the odds change a log-likelihood ratio by 0.7."""


def prior_log_odds(names: int) -> float:
    """Return the prior log odds (natural logarithm) of one of several possible answers, all of the same probability."""
    return -float(logit(NOTHING) + np.log(names))


MOST = round(1 / (1 - NOTHING))
"""Number of single effects in the sum, of which one is expected to be present: people diagnose robots that have a
fault. Descriptions are hardly expected to miss more than five at once; each costs time."""

FAULT = 10.0
"""Prior scale of a fault's size, as a multiple of what robots in good order show (the effect's tolerance): the size is
Cauchy distributed with this scale, so half of all faults are larger. A scale ten times smaller or larger changes a
log-likelihood ratio by at most 2.3."""

FREEDOM = 4.0
"""Weight of an effect's stated tolerance, as degrees of freedom of a variance estimate: two clean logs count half as
much as the catalogue's statement, for each effect of a class that they show."""

SIGNATURE, REFITTED = 0.05, 0.002
"""Relative error of an effect's signature, in any direction that other effects span: standard deviations, of effects
that are extrapolated linearly, and of effects that are in the model. The second was set on cases of `castor-diagnose
trial --cases 80 --seed 201`: with 1 %, small effects beside an effect of 100 mm per 10 m go undetected; the cases of
seed 203 confirm it."""
