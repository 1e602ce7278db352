"""`python -m raden_torch` is `raden`."""

from raden_torch.cli import main

main()
