"""The stages of a run: plan, record, evaluate."""
