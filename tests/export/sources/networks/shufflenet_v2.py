from network_row import NetworkRow

ROW = NetworkRow(
    parameters=2_278_604 - 1_025_000,
    input_size=224,
    maps={"maxpool": (24, 56, 56), "stage2.3": (116, 28, 28), "stage4.3": (464, 7, 7), "conv5": (1024, 7, 7)},
    geometry=(("stage2.1", (160, 192)),),
    other_layers=("stage2.0", "stage2.1"),
)
