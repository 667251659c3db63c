"""Many runs at once through Hydra's launchers: trained where missing, watched, stopped."""
