from network_row import NetworkRow

# Caffe's, by its convolutions.
ROW = NetworkRow(
    parameters=34_944 + 307_456 + 885_120 + 663_936 + 442_624,
    input_size=227,
    maps={"conv1": (96, 55, 55), "pool1": (96, 27, 27), "pool2": (256, 13, 13), "pool5": (256, 6, 6)},
    geometry=(("pool2", (120, 136)),),
    other_layers=("pool2",),
    weights="alexnet_caffe_conv_8bit.npz",
)
