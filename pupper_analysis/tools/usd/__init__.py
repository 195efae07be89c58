"""Read USD files (UsdPhysics), as Isaac Sim's, for `audit` and `crosscheck`."""
