"""Suites: scenes × dials × seeds × systems, run by many processes and resumed after a kill."""
