"""Forces in equilibrium."""
