"""Oracles: poses of estimators that are told what nobody can know, stored as `Run.oracle`; no strict bounds."""
