from network_row import NetworkRow

ROW = NetworkRow(
    parameters=11_689_512 - 513_000,
    input_size=224,
    maps={"maxpool": (64, 56, 56), "layer2.1": (128, 28, 28), "layer4.1": (512, 7, 7)},
    geometry=(("layer2.0", (160, 192)),),
)
