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
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
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
        cls.bag = os.path.join(cls.recording, 'recording.bag')
        cls.rig = os.path.join(cls.recording, 'rig_initial.yaml')
        cls.diagnoses = {}
        cls.subscribers.append(
            rospy.Subscriber('/diagnostics', DiagnosticArray, cls.note_diagnosis))
        cls.start_nodes(cls.rig)

    @classmethod
    def tearDownClass(cls):
        cls.stop_nodes()

    @classmethod
    def start_nodes(cls, rig):
        cls.states.clear()
        cls.nodes = subprocess.Popen(
            ['roslaunch', 'scenecalib', 'calibration.launch', 'rig:=' + rig])

    @classmethod
    def stop_nodes(cls):
        cls.nodes.terminate()
        cls.nodes.wait(timeout=60)

    @classmethod
    def note_diagnosis(cls, message):
        for status in message.status:
            if 'calibration' in status.name:
                cls.diagnoses[status.level] = status.message

    @classmethod
    def note_state(cls, state):
        cls.states[state.sensor] = state

    def call(self, name, service, *arguments):
        rospy.wait_for_service(name, timeout=TIMEOUT_S)
        return rospy.ServiceProxy(name, service)(*arguments)

    def play(self, bag):
        before = {name: s.num_measurements for name, s in self.states.items()}
        player = subprocess.run(['rosbag', 'play', '--quiet', '--delay', '4', '--rate', '0.5', bag],
                                check=False)
        self.assertEqual(player.returncode, 0)
        deadline = time.time() + TIMEOUT_S
        previous = None
        while time.time() < deadline:  # until the nodes have worked off their queues
            counts = {name: s.num_measurements for name, s in self.states.items()}
            if len(counts) == len(self.truth) + 1 and counts == previous and counts != before:
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

        self.play(self.bag)
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
        self.assertIn('accepted before stays in force', emptied.message)
        self.check_that_standing_still_is_refused()
        self.assertIsNone(self.nodes.poll(), 'a node ended')
        self.stop_nodes()
        self.check_that_a_camera_at_night_keeps_the_fallback(path)
        self.assertIsNone(self.nodes.poll(), 'a node ended')

    def check_that_standing_still_is_refused(self):
        bag = os.path.join(rospy.get_param('~data'), 'still.bag')
        self.play(recording.write_standing_still(self.bag, bag))
        earlier = self.call('/calibration_server/get', GetCalibration).result
        answer = self.call('/calibration_server/recalibrate', Recalibrate)
        self.assertEqual(answer.verdict, 'failed', answer.message)
        self.assertIn('did not move', answer.message)
        self.assertIn('accepted before stays in force', answer.message)
        self.assertEqual(self.call('/calibration_server/get', GetCalibration).result.yaml,
                         earlier.yaml)
        self.check_diagnosis(DiagnosticStatus.ERROR, 'did not move')

    def check_that_a_camera_at_night_keeps_the_fallback(self, fallback):
        """One of two cameras in the dark; the rig file names the earlier result."""
        with open(self.rig, encoding='utf-8') as stream:
            rig = yaml.safe_load(stream)
        rig['fallback'] = fallback
        path = os.path.join(rospy.get_param('~data'), 'rig_with_fallback.yaml')
        with open(path, 'w', encoding='utf-8') as stream:
            yaml.safe_dump(rig, stream, sort_keys=False)
        self.start_nodes(path)
        bag = os.path.join(rospy.get_param('~data'), 'night.bag')
        self.play(recording.write_changed(self.bag, bag, ['front'], recording.night))
        answer = self.call('/calibration_server/recalibrate', Recalibrate)
        self.assertEqual(answer.verdict, 'partly_accepted', answer.message)
        self.assertIn('front: not accepted, too dark', answer.message)
        self.assertIn('keeps the values of ' + fallback, answer.message)
        self.assertIn('left: accepted', answer.message)
        self.check_answer(answer)  # the values in force, those of the fallback included
        by_name = {camera.name: camera for camera in answer.result.cameras}
        self.assertFalse(by_name['front'].accepted)
        translation = by_name['front'].lidar_from_camera.translation
        kept = recording.lidar_from_camera(fallback)['front'][0]
        for value, expected in zip((translation.x, translation.y, translation.z), kept):
            self.assertAlmostEqual(value, expected, places=9)
        self.check_diagnosis(DiagnosticStatus.WARN, 'too dark')
        transform = self.lookup('front').translation  # what is in force is what tf says
        self.assertAlmostEqual(transform.x, kept[0], places=9)

    def check_diagnosis(self, level, words):
        level = ord(level) if isinstance(level, bytes) else level
        self.diagnoses.clear()
        deadline = time.time() + 30.0
        while time.time() < deadline and words not in self.diagnoses.get(level, ''):
            time.sleep(0.5)
        self.assertIn(words, self.diagnoses.get(level, ''), self.diagnoses)

    @staticmethod
    def lookup(camera):
        buffer = tf2_ros.Buffer()
        listener = tf2_ros.TransformListener(buffer)
        transform = buffer.lookup_transform('lidar', f'{camera}_optical', rospy.Time(0),
                                            rospy.Duration(10)).transform
        del listener
        return transform

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
