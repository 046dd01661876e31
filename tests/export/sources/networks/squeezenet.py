from network_row import NetworkRow

ROW = NetworkRow(
    parameters=1_235_496 - 513_000,
    input_size=224,
    maps={"pool1": (64, 55, 55), "pool3": (128, 27, 27), "fire9": (512, 13, 13)},
    geometry=(("fire4", (120, 136)),),
    other_layers=("fire5",),
    weights="squeezenet1_1_imagenet_keras.npz",
)
