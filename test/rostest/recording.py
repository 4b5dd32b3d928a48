"""A small simulated recording, made once and shared by the tests, and how to judge a result."""
import math
import os
import subprocess

import yaml

HERE = os.path.dirname(os.path.abspath(__file__))

# The recording is small, so that the test is quick: wider bounds than those of a full one.
MAX_ROTATION_DEG = 0.5
MAX_TRANSLATION_M = 0.10


def make(binaries, directory):
    """Simulates the recording unless it is there; returns its directory."""
    path = os.path.join(directory, 'recording')
    if not os.path.exists(os.path.join(path, 'truth_image_times.txt')):
        subprocess.run([os.path.join(binaries, 'simulate'), '--output', path,
                        '--rig', os.path.join(HERE, 'small_rig.yaml'),
                        '--config', os.path.join(HERE, 'small_simulation.yaml')], check=True)
    return path


def lidar_from_camera(path):
    """Translation and quaternion (x, y, z, w) of every camera in a rig file, by name."""
    with open(path, encoding='utf-8') as stream:
        cameras = yaml.safe_load(stream)['cameras']
    return {name: (camera['lidar_from_camera']['translation_m'],
                   camera['lidar_from_camera']['rotation_xyzw'])
            for name, camera in cameras.items()}


def errors(estimate, truth):
    """Rotation in degrees and distance in metres between two transforms."""
    dot = abs(sum(a * b for a, b in zip(estimate[1], truth[1])))
    norm = math.sqrt(sum(a * a for a in estimate[1])) * math.sqrt(sum(b * b for b in truth[1]))
    rotation_deg = math.degrees(2.0 * math.acos(min(1.0, dot / norm)))
    return rotation_deg, math.dist(estimate[0], truth[0])
