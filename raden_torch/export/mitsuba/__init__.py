"""A model in Mitsuba 3: a BSDF plugin that reads the runtime table, and a file that uses it."""
