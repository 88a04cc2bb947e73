"""Campaigns: many runs of a job with everything that may vary, and what they say together."""
