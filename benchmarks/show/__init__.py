"""One case or log, seen: what estimators made of it, where wheels disagreed and slipped, as page and picture."""
