"""Compiled functions: written in Python, kept as machine code that later processes load without the compiler."""
