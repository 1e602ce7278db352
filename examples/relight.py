"""Relight a photograph with an exported shader: onnxruntime and OpenCV, nothing else.

python relight.py shell.onnx photo.png normals.png 1,1,2 relit.png

The normal map: red right, green up, blue towards the viewer; its alpha says where the material is.
"""

import sys

import cv2
import numpy as np
import onnxruntime as ort

model, photo_path, normals_path, lamp, output_path = sys.argv[1:]


def read(path: str) -> np.ndarray:
    image = cv2.imread(path, cv2.IMREAD_UNCHANGED)
    if image is None:
        sys.exit(f"{path}: not a picture that OpenCV reads")
    return image.astype(np.float32) / np.iinfo(image.dtype).max


photo, normals = read(photo_path)[..., 2::-1], read(normals_path)  # BGR to RGB
if photo.shape[:2] != normals.shape[:2] or normals.shape[2] != 4:
    sys.exit(f"{normals_path}: expected the photograph's size and an alpha, got {normals.shape}")
mask = normals[..., 3:]
normal = (normals[..., 2::-1] * 2 - 1) * (mask > 0)  # 0 is no normal, and no light
linear = np.where(photo <= 0.04045, photo / 12.92, ((photo + 0.055) / 1.055) ** 2.4)

options = ort.SessionOptions()
options.log_severity_level = 3  # else it remarks that some inputs have defaults, as they should
session = ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])
inputs = {
    "normal": np.ascontiguousarray(normal.transpose(2, 0, 1)[None]),
    "light": np.array(lamp.split(","), np.float32).reshape(1, 3, 1, 1),
    "view": np.array([0, 0, 1], np.float32).reshape(1, 3, 1, 1),
}
radiance = session.run(["radiance"], inputs)[0][0].transpose(1, 2, 0)

relit = np.clip(linear + mask * (radiance - linear), 0, 1)
shown = np.where(relit <= 0.0031308, 12.92 * relit, 1.055 * relit ** (1 / 2.4) - 0.055)
if not cv2.imwrite(output_path, np.rint(255 * shown[..., ::-1]).astype(np.uint8)):
    sys.exit(f"{output_path}: cannot be written")
