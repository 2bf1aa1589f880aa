"""All hardware: tactile sensors, arm, teleoperators, recorder, equilibrium pairs, stand-ins."""
