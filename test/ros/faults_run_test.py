#!/usr/bin/python3
"""What scripts/faults makes of what it observes."""

import os
import sys
import unittest

sys.dont_write_bytecode = True
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', '..', 'scripts'))
import faults_run  # noqa: E402
from faults_run import Seen  # noqa: E402


def heard(after):
  """States of a simulation that was killed at 1.0 s, and the journal of the next one as {step: hash}."""
  before = [Seen(0.5, 'journal', 1, 20, 7), Seen(0.9, 'journal', 1, 40, 8), Seen(0.95, 'grid', 1, 45, 0)]
  return before + [Seen(1.5, 'journal', 2, step, value) for step, value in after.items()]


class LossTest(unittest.TestCase):

  def test_the_first_step_that_both_journaled_is_compared(self):
    self.assertEqual(faults_run.tissue_loss(heard({40: 8, 60: 9}), 1.0), (0.005, True))
    self.assertEqual(faults_run.tissue_loss(heard({40: 6, 60: 9}), 1.0), (0.005, False))
    self.assertEqual(faults_run.tissue_loss(heard({30: 5, 40: 6}), 1.0)[1], False)

  def test_what_cannot_be_compared_has_not_survived(self):
    _, same = faults_run.tissue_loss(heard({60: 9}), 1.0)
    self.assertIsNone(same)
    for bits, survived in ((True, True), (False, False), (None, False)):
      self.assertEqual(faults_run.judge(dict(same_bits=bits))['survived'], survived)
    self.assertTrue(faults_run.judge({})['survived'])

  def test_memory_is_judged_by_node(self):
    grown = {'tool': (20.0, 39.0), 'recorder': (30.0, 200.0)}
    self.assertTrue(faults_run.judge(dict(memory_mib=grown))['survived'])
    self.assertFalse(faults_run.judge(dict(memory_mib={'tool': (20.0, 41.0)}))['survived'])
    self.assertFalse(faults_run.judge(dict(memory_mib={'recorder': (30.0, 231.0)}))['survived'])

  def test_a_part_that_fails_leaves_the_others(self):

    def fail():
      raise faults_run.Failure('no push')

    figures = faults_run.part('soak', fail)
    self.assertEqual([(f['fault'], f['survived'], f['reasons']) for f in figures], [('soak', False, ['no push'])])
    faults_run.table(figures)
    self.assertEqual(faults_run.summary(figures)['survived'], 0)


if __name__ == '__main__':
  unittest.main()
