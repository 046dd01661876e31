from network_row import NetworkRow

ROW = NetworkRow(
    weights="alexnet_caffe_conv_8bit.npz",
)
