"""Diagnosis of trains: names the effects missing in a description, of posture sensors, axles or the floor."""
