"""Everything with a plug: tactile sensors, arm, teleoperators, recorder, equilibrium pairs, stand-ins."""
