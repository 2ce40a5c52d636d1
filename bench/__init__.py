"""Benchmarks: every stage over photon counts and threads, compared with other packages.

``python -m pytest bench`` times the stages one by one; ``python -m bench`` measures them side by
side with their peers and prints the table of the README. Peers come with the extra `bench`.
"""
