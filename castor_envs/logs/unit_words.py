"""Words by which names of columns, and lines of units above them, say units."""

WORDS = {
    "rpm": {"rpm"},
    "counts": {"tick", "ticks", "count", "counts", "cps"},
    "deg": {"deg", "degs", "degrees", "degree", "dps"},
    "rev": {"rev", "revs", "rot", "rotations", "turns"},
    "rad": {"rad", "rads", "radians"},
    "m": {"m", "mps", "meters", "metres", "mm", "cm"},
}
"""Words that say a unit, or a speed in it; millimetres of a wheel are metres by a scale."""

TIMES = {
    "ns": {"ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanoseconds"},
    "us": {"us", "µs", "μs", "usec", "usecs", "micros", "microsec", "microsecs", "microseconds"},
    "ms": {"ms", "msec", "msecs", "millis", "millisec", "millisecs", "milliseconds"},
    "s": {"s", "sec", "secs", "seconds"},
    "min": {"min", "mins", "minutes"},
}
"""Words that say a unit of time; the micro sign and the Greek letter are two characters."""
