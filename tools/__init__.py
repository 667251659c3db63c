"""Programs beside the package: chaos, fuzzing."""
