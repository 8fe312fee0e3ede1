"""The numbers of the inference, each with its reason.

`castor-diagnose trial` judges them together: rates, reliability diagram, expected calibration error.
What contacts and trackers are like is stated where logs are linearised, what robots are like by each effect class.
"""

from scipy.special import logit

CREDIBLE = 0.95
"""Probability that a credible set holds at least, and with its odds (19, a log-likelihood ratio of ln 19) what held-out
logs must say for a name. The field's convention; nothing was fitted to it."""

LOG_ODDS = float(logit(CREDIBLE))
"""What `CREDIBLE` is as natural logarithm of odds."""

NOTHING = 0.8
"""Probability that one single effect of the sum is none, before logs are seen. Of five, one is expected to be there:
people ask about robots that have something. Twice the odds change a log-likelihood ratio by 0.7."""

MOST = 5
"""Single effects in the sum: more than robots are expected to miss at once; each costs time."""

FAULT = 10.0
"""A fault, as a multiple of what robots in good order show (an effect's tolerance), is as often larger as smaller; its
size is Cauchy distributed. A tenth or ten times of it changes a log-likelihood ratio by at most 2.3."""

FREEDOM = 4.0
"""Robots whose scatter an effect's stated tolerance stands for, as degrees of freedom: two clean logs count half as
much as what the catalogue states."""

SIGNATURE, REFITTED = 0.05, 0.002
"""Part by which the signature of an effect is wrong, in any direction that other effects span: standard deviations, of
effects looked at from afar, linearly, and of those in the model. The second was set on cases of `castor-diagnose trial
--cases 80 --seed 201`: with 1 %, small effects beside one of 100 mm per 10 m stay unseen; seed 203 bears it out."""
