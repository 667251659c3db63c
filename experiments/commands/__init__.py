"""The commands of ``risfleet``, a module each."""
