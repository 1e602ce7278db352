"""Simulated photographs, rendered by Mitsuba 3: of known camera, lamps, colours and BRDF.

It shares no code with what they are made to test: nothing of `raden_torch.geometry`, of `brdf` or
of the rest of `capture` is imported here, and an import contract keeps it so.
"""
