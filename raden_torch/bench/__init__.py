"""What `raden bench` does: run time against error, of every form of the model and every backend."""

from raden_torch.bench.naive_form import naive
from raden_torch.bench.run import OUTPUTS, run_bench
from raden_torch.bench.simulated_truth import simulated_pair

__all__ = ["OUTPUTS", "naive", "run_bench", "simulated_pair"]
