"""Finding and checking plug-ins: estimators and calibration methods of other authors."""
