"""Effects: what a real robot or train does that its description leaves out. Each is one class, with one meaning.

`castor_envs.vehicles.effect` says what an effect is. Here `catalogue` finds them all and says what all effects of a
robot do together, and `parts` finds the castor, wheel or encoder that an effect changes; every other module holds
effects of one kind. To add one, add a class to such a module, or a module: files, catalogue, tables and tests find it.
"""
