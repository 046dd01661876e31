"""From a saliency map to keypoints and descriptors: functions of arrays, of which `detect.detect` is the whole.

May import the rooms of models, images and results below it; nothing here runs a model.
"""
