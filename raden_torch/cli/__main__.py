"""`python -m raden_torch.cli` is `raden`."""

from raden_torch.cli import main

main()
