"""Read USD files (UsdPhysics), for example those of Isaac Sim, for `audit` and `crosscheck`."""
