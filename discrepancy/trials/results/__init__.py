"""Results of a trial: rates of right and wrong answers, and the cases that count against the finder."""
