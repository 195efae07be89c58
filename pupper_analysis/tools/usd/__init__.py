"""Read USD files (UsdPhysics), for example files of Isaac Sim, for `audit` and `crosscheck`."""
