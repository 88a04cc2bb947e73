"""Certificates: matrices that prove what a design claims, and their proof in interval arithmetic."""
