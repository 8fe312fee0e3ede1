"""Ceilings of what is possible: poses of estimators who know what nobody can know, stored as `Run.oracle`."""
