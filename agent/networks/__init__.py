"""Networks as flat rows, how outputs become action values, absurd weights."""
