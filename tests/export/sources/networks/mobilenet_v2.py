from network_row import NetworkRow

ROW = NetworkRow(
    parameters=3_504_872 - 1_281_000,
    input_size=224,
    maps={"features.3": (24, 56, 56), "features.6": (32, 28, 28), "features.18": (1280, 7, 7)},
    geometry=(("features.3", (120, 136)),),
)
