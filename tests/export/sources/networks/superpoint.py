from network_row import NetworkRow

# Less the detector's head.
ROW = NetworkRow(
    parameters=1_300_865 - 311_873,
    input_size=240,
    maps={"conv1a": (64, 240, 240), "relu4b": (128, 30, 30), "desc": (256, 30, 30)},
    geometry=(("relu4b", (160, 168)),),
    other_layers=("relu1a", "pool1"),
    weights="superpoint_v1_encoder_descriptor.npz",
)
