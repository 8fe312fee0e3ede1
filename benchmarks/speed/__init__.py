"""How fast everything is, beside peers: ``castor-bench speed``. A group of figures is a module that offers `GROUP`."""
