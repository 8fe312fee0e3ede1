"""How cost grows with size: ``castor-bench speed --growth``. Curves are what modules here offer as `curves`."""
