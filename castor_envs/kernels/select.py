"""What branch-free kernels say instead of `if`: so they compile for single numbers and for lanes of them alike.

A condition on lanes holds for some of them and not for others. `&` and `|` join conditions; `not` and `~` do not.
"""

from typing import Any


def where(condition: Any, this: Any, otherwise: Any) -> Any:
    """Return `this` where a condition holds, else `otherwise`; both have been computed."""
    return this if condition else otherwise


def any_of(condition: Any) -> Any:
    """Return whether a condition holds at all."""
    return condition
