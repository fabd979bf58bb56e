"""Many images together: intersection of rays, bundle adjustment, boresight."""
