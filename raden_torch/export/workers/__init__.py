"""Runtimes in processes of their own: Node.js, a browser, another Python."""
