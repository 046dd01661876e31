from network_row import NetworkRow

ROW = NetworkRow()
