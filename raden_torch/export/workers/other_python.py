"""ONNX Runtime in another Python: needs onnxruntime and numpy there, nothing of ours."""

import json
import sys
import time
from pathlib import Path


def main(folder: Path) -> None:
    import numpy as np
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.log_severity_level = 3
    session = ort.InferenceSession(
        str(folder / "model.onnx"), options, providers=["CPUExecutionProvider"]
    )
    say(version=ort.__version__)
    for line in sys.stdin:
        request = json.loads(line)
        inputs = {
            name: np.fromfile(folder / f"{name}.bin", "<f4").reshape(sizes)
            for name, sizes in request["inputs"].items()
        }
        try:
            times = []
            for _ in range(request["repeat"]):
                start = time.perf_counter()
                output = session.run(None, inputs)[0]
                times.append(1000 * (time.perf_counter() - start))
        except Exception as error:  # its errors share no base class but this one
            say(error=str(error))
            continue
        output.tofile(folder / "output.bin")
        say(shape=list(output.shape), milliseconds=times)


def say(**words: object) -> None:
    print(json.dumps(words), flush=True)


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except Exception as error:  # whatever it is, whoever started this wants to read it
        say(error=f"{type(error).__name__}: {error}")
