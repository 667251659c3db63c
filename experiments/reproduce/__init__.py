"""``risfleet reproduce``: the paper's figures with statistics, and what else is measured."""
