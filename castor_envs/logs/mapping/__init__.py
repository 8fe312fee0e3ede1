"""From a recording's channels to a log's columns: the map that says which is which, and what follows from it."""
