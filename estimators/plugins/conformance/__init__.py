"""What castor-bench check checks of an estimator, on short noise-free drives."""
