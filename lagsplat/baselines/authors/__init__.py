"""GaussianPrediction as its authors released it: an external tool that the user has, run from here."""
