"""From a saliency map to keypoints and descriptors: functions of arrays.

May import the settings, the contract, `image` and errors; nothing here runs a model.
"""
