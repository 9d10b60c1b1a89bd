"""Speed against accuracy, stability, scaling: the instruments that every change of the engine is seen in."""
