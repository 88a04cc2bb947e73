"""Shipped plant files."""
