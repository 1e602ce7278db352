"""A goniospectrometer: its instruments over a serial line, the scan, and what becomes of it.

Needs no torch: a scan runs for many hours on whatever machine stands beside the rig.
"""
