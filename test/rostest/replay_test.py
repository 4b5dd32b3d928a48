#!/usr/bin/python3
"""The nodes of the vehicle: a recording is played into them, then the service is called."""
import os
import subprocess
import sys
import time
import unittest

import rospy
import rostest
import tf2_ros
from scenecalib.msg import Calibration, SegmentState
from scenecalib.srv import GetCalibration, Recalibrate, Save
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import recording  # noqa: E402

TIMEOUT_S = 300.0
# This camera's frame has a parent already (replay.test): nothing may be published for it.
CAMERA_WITH_PARENT = 'left'


class Replay(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.recording = recording.make(rospy.get_param('~binaries'), rospy.get_param('~data'))
        cls.truth = recording.lidar_from_camera(os.path.join(cls.recording, 'truth.yaml'))
        cls.states = {}
        cls.subscribers = [
            rospy.Subscriber('/lidar_mapping/state', SegmentState, cls.note_state)]
        for camera in cls.truth:
            cls.subscribers.append(rospy.Subscriber(f'/camera_tracking/{camera}/state',
                                                    SegmentState, cls.note_state))
        cls.nodes = subprocess.Popen(
            ['roslaunch', 'scenecalib', 'calibration.launch',
             'rig:=' + os.path.join(cls.recording, 'rig_initial.yaml')])

    @classmethod
    def tearDownClass(cls):
        cls.nodes.terminate()
        cls.nodes.wait(timeout=60)

    @classmethod
    def note_state(cls, state):
        cls.states[state.sensor] = state

    def call(self, name, service, *arguments):
        rospy.wait_for_service(name, timeout=TIMEOUT_S)
        return rospy.ServiceProxy(name, service)(*arguments)

    def play(self):
        player = subprocess.run(['rosbag', 'play', '--quiet', '--delay', '4', '--rate', '0.5',
                                 os.path.join(self.recording, 'recording.bag')], check=False)
        self.assertEqual(player.returncode, 0)
        deadline = time.time() + TIMEOUT_S
        previous = None
        while time.time() < deadline:  # until the nodes have worked off their queues
            counts = {name: s.num_measurements for name, s in self.states.items()}
            if len(counts) == len(self.truth) + 1 and counts == previous:
                return
            previous = counts
            time.sleep(3.0)
        self.fail(f'nodes did not take the recording: {self.states}')

    def test_recalibrates_what_was_played(self):
        refused = self.call('/calibration_server/recalibrate', Recalibrate)
        self.assertEqual(refused.verdict, 'failed', refused)  # nothing was driven yet
        self.assertTrue(refused.message)
        self.assertFalse(self.call('/calibration_server/get', GetCalibration).success)
        self.assertFalse(self.call('/calibration_server/save', Save, '').success)
        self.assertFalse(self.call('/calibration_server/cancel', Trigger).success)

        self.play()
        answer = self.call('/calibration_server/recalibrate', Recalibrate)
        self.assertEqual(answer.verdict, 'accepted', answer.message)
        self.check_answer(answer)
        self.check_tf()
        self.check_topics()

        path = os.path.join(rospy.get_param('~data'), 'saved.yaml')
        self.assertTrue(self.call('/calibration_server/save', Save, path).success)
        self.assertEqual(list(recording.lidar_from_camera(path)), list(self.truth))
        self.assertTrue(self.call('/calibration_server/reset', Trigger).success)
        emptied = self.call('/calibration_server/recalibrate', Recalibrate)
        self.assertEqual(emptied.verdict, 'failed')
        self.assertTrue(self.call('/calibration_server/get', GetCalibration).success)  # still there
        self.assertIsNone(self.nodes.poll(), 'a node ended')

    def check_answer(self, answer):
        self.assertEqual([c.name for c in answer.result.cameras], list(self.truth))
        for camera in answer.result.cameras:
            t, q = camera.lidar_from_camera.translation, camera.lidar_from_camera.rotation
            self.check_close(camera.name, ((t.x, t.y, t.z), (q.x, q.y, q.z, q.w)))
        self.assertIn('quality', answer.result.yaml)

    def check_close(self, camera, estimate):
        rotation_deg, distance_m = recording.errors(estimate, self.truth[camera])
        self.assertLess(rotation_deg, recording.MAX_ROTATION_DEG, camera)
        self.assertLess(distance_m, recording.MAX_TRANSLATION_M, camera)

    def check_tf(self):
        buffer = tf2_ros.Buffer()
        listener = tf2_ros.TransformListener(buffer)
        for camera in self.truth:
            if camera == CAMERA_WITH_PARENT:
                continue
            transform = buffer.lookup_transform('lidar', f'{camera}_optical', rospy.Time(0),
                                                rospy.Duration(10)).transform
            t, q = transform.translation, transform.rotation
            self.check_close(camera, ((t.x, t.y, t.z), (q.x, q.y, q.z, q.w)))
        time.sleep(1.0)
        with self.assertRaises(tf2_ros.TransformException):
            buffer.lookup_transform('lidar', f'{CAMERA_WITH_PARENT}_optical', rospy.Time(0))
        del listener

    def check_topics(self):
        for topic, kind in (('/calibration_server/calibration', Calibration),
                            ('/calibration_server/coloured_cloud', PointCloud2),
                            ('/calibration_server/bundles_after', Marker),
                            ('/lidar_mapping/map', PointCloud2),
                            ('/lidar_mapping/surfels', Marker),
                            ('/lidar_mapping/ground', Marker)):
            message = rospy.wait_for_message(topic, kind, timeout=10)
            if kind is PointCloud2:
                self.assertGreater(message.width, 100, topic)
            if kind is Marker:
                self.assertGreater(len(message.points), 100, topic)


if __name__ == '__main__':
    rospy.init_node('replay_test')
    rostest.rosrun('scenecalib', 'replay', Replay)
