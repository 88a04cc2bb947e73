"""Plots for scripts: of systems, loops, plants, runs and campaigns; each file draws one kind."""
