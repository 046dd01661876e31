from network_row import NetworkRow

ROW = NetworkRow(
    input_size=64,
    maps={"block2-conv": (16, 64, 64), "block2-bn": (16, 64, 64), "block3": (16, 64, 64)},
    other_layers=("block2-conv",),
)
