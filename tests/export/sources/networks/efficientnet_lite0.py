from network_row import NetworkRow

ROW = NetworkRow(
    parameters=4_652_008 - 1_281_000,
    input_size=224,
    maps={"blocks.1.1": (24, 56, 56), "head": (1280, 7, 7)},
    geometry=(("blocks.1.1", (120, 136)),),
)
