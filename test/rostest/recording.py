"""A small simulated recording, made once and shared by the tests, the same in bad conditions, and
how to judge a result."""
import math
import os
import subprocess

import numpy as np
import rosbag
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


def night(pixels, random):
    """Dark, with the sensor's noise."""
    return pixels / 32.0 + 3.0 * random.randn(*pixels.shape)


def rain(pixels, random):
    """A grey veil and streaks that are elsewhere in every image."""
    wet = 80.0 + 0.3 * pixels
    for _ in range(6000):
        row, column = random.randint(pixels.shape[0] - 14), random.randint(pixels.shape[1] - 3)
        wet[row:row + 14, column:column + 3] = 230.0
    return wet


def snow(pixels, random):
    """A white veil and flakes of all sizes that are elsewhere in every image."""
    white = 110.0 + 0.4 * pixels
    rows, columns = np.mgrid[-6:7, -6:7]
    for _ in range(5000):
        radius = random.uniform(1.0, 6.0)
        flake = 100.0 * np.exp(-(rows ** 2 + columns ** 2) / radius ** 2)
        row, column = random.randint(pixels.shape[0] - 13), random.randint(pixels.shape[1] - 13)
        white[row:row + 13, column:column + 13] += flake
    return white


def sky(pixels, random):
    """Nothing but a clear sky."""
    rows = np.linspace(210.0, 150.0, pixels.shape[0])[:, None]
    return rows + random.randn(*pixels.shape)


def write_changed(bag, path, cameras, change):
    """Copies the bag with change(pixels as rows x step, random) applied to the cameras' images."""
    random = np.random.RandomState(1)
    topics = [f'/{camera}/image_raw' for camera in cameras]
    with rosbag.Bag(bag) as source, rosbag.Bag(path, 'w') as target:
        for topic, message, stamp in source.read_messages():
            if topic in topics:
                pixels = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
                changed = change(pixels.astype(float), random)
                message.data = np.clip(changed, 0, 255).astype(np.uint8).tobytes()
            target.write(topic, message, stamp)
    return path


def write_standing_still(bag, path):
    """One scan and one image per camera again and again, with stamps that go on; no other sensor."""
    first = {}
    with rosbag.Bag(bag) as source, rosbag.Bag(path, 'w') as target:
        for topic, message, stamp in source.read_messages():
            if topic == '/lidar/points' or 'image' in topic:
                still = first.setdefault(topic, message)
                still.header.stamp = message.header.stamp
                target.write(topic, still, stamp)
    return path
