"""Kills processes of real runs at random moments, and holds the runs to what they promise.

A kill is survived if what is left of the run goes on to its end or ends in time with one clear
sentence, nothing of it stays behind, and a resume ends in the bits of a run that nobody disturbed.
"""
