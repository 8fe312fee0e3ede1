"""Finding and checking estimators and calibration methods that others wrote."""
