from network_row import NetworkRow

ROW = NetworkRow(
    input_size=40,
    maps={"magnitude": (1, 40, 40)},
)
