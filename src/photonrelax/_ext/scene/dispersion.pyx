"""Range of the wavelengths of dispersed light, nm, and the number of those in tables."""

RANGE = (<double> SHORTEST, <double> LONGEST)
NODES = N_NODES
