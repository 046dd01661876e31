from network_row import NetworkRow

ROW = NetworkRow(
    parameters=61_100_840 - 37_752_832 - 16_781_312 - 4_097_000,
    input_size=224,
    maps={"pool1": (64, 27, 27), "pool2": (192, 13, 13), "pool5": (256, 6, 6)},
    geometry=(("pool1", (120, 136)),),
)
