"""Short runs in passes, and what two of them are compared by."""

FEW = {"photons_per_pass": 2000, "seed": 3}


def layers_bytes(image):
    return {name: layer.tobytes() for name, layer in image.layers.items()}
