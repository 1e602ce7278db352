"""The model: diffuse part, table, the module made of them, and its CPU kernel."""
