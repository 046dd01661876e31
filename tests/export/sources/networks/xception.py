from network_row import NetworkRow

ROW = NetworkRow(
    input_size=299,
    maps={"block1-conv2": (64, 147, 147), "block2": (128, 74, 74), "block4-pool": (728, 19, 19)},
    geometry=(("block2-conv1", (120, 136)), ("block2-pool", (120, 136)), ("block3", (121, 137))),
    other_layers=("block2-conv1-bn", "block2", "block3-pool"),
    weights="xception_imagenet_entry_flow.npz",
)
