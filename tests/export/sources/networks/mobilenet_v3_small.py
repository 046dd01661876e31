from network_row import NetworkRow

# A global pool lets every cell see the whole image, so there is no geometry to look at.
ROW = NetworkRow(
    parameters=2_542_856 - 1_615_848,
    input_size=224,
    maps={"features.1": (16, 56, 56), "features.12": (576, 7, 7)},
)
