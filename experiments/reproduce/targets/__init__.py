"""The paper's figures, claims and ablations."""
