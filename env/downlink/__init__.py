"""Rates of NOMA and OMA, and powers that can be decoded."""
