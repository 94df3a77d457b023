"""Networks of the agents: from the environment's raw observation to its action.

Feature map (all of it is exported with the policy):

    2 x                  state over uncontrolled amplitudes
    clip(90 x, +-3)      the same magnified, so that amplitudes of 0.1 % stay visible
    a_i                  envelope amplitudes
    y, y', F, F'         what the world does (``observe="full"``)
    2 z, clip(g z, +-3)  complex envelope z_i = (x_i - i v_i / omega) e^{-i omega t}: the state in
                         the frame that turns with the road, which in steady state stands still
    1 / limit, x / limit, ...   (`observe_limit`) force over its limit is what the action says

and behind it a small tanh network *and* a direct linear path to the action. A saturated linear
law, the best classical one, is in reach of the direct path alone; the network bends it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.sac.policies import Actor as SACActor, SACPolicy
from stable_baselines3.td3.policies import Actor as TD3Actor, TD3Policy
from torch import Tensor, nn

from qcar_env.agents.recipes import FeatureMap
from qcar_env.envs import episode as task

TINY = 1e-6  # [-] keeps a direction defined where the road is flat


def space(observe: task.Observe, observe_limit: bool) -> gym.spaces.Box:
    """Return the space of the raw observation, as the environment's."""
    high, size = task.OBSERVATION_LIMIT, len(task.observed(observe, observe_limit))
    return gym.spaces.Box(-high, high, (size,), np.float32)


class Features(BaseFeaturesExtractor):
    """The feature map as a torch module.

    Parameters
    ----------
    observation_space : gymnasium.spaces.Box
        Space of the raw observation.
    features : FeatureMap
        What is made of it.
    """

    def __init__(self, observation_space: gym.Space[Any], features: FeatureMap) -> None:
        size = observation_space.shape[0]  # type: ignore[index]
        self.has_limit = size in (task.FEEDBACK_SIZE + 1, task.FULL_SIZE + 1)
        self.kind = features.kind
        count = {"plain": size, "feedback": 10, "full": 22}[features.kind]
        if self.has_limit and features.kind != "plain":
            count = 2 * count + 1
        super().__init__(observation_space, count)
        first, second = features.magnify
        self.bound = features.bound
        self.register_buffer("gain", torch.tensor([first, second, first, second]))

    def forward(self, observation: Tensor) -> Tensor:
        """Return the features, shape (n, features_dim), of observations (n, k)."""
        if self.kind == "plain":
            return observation
        x = observation[:, :4]
        envelope = torch.sqrt(x[:, 0:2] * x[:, 0:2] + x[:, 2:4] * x[:, 2:4])
        parts = [2.0 * x, self._magnified(x), envelope]
        if self.kind == "full":
            world = observation[:, 4:8]
            s, c = world[:, 0:1], world[:, 1:2]
            norm = torch.rsqrt(s * s + c * c + TINY)
            s, c = s * norm, c * norm
            z = torch.cat([x[:, 0:2] * c - x[:, 2:4] * s, x[:, 0:2] * s + x[:, 2:4] * c], dim=1)
            parts += [world, 2.0 * z, self._magnified(z)]
        found = torch.cat(parts, dim=1)
        if self.has_limit:
            limit = observation[:, -1:]
            found = torch.cat([found, found / limit, 0.1 / limit], dim=1)
        return found

    def _magnified(self, x: Tensor) -> Tensor:
        return torch.clamp(x * self.gain, -self.bound, self.bound)


class Bent(nn.Module):
    """A small tanh network beside the identity: its output ends with its input."""

    def __init__(self, inputs: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        self.net = tanh_layers(inputs, hidden)
        self.outputs = hidden[-1] + inputs

    def forward(self, features: Tensor) -> Tensor:
        """Return network output and features side by side."""
        return torch.cat([self.net(features), features], dim=1)


class BentExtractor(nn.Module):
    """Actor with a direct path and critic without, in the place of SB3's `MlpExtractor`."""

    def __init__(self, inputs: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        self.policy_net = Bent(inputs, hidden)
        self.value_net = tanh_layers(inputs, hidden)
        self.latent_dim_pi = self.policy_net.outputs
        self.latent_dim_vf = hidden[-1]

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Return the latents of actor and critic."""
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: Tensor) -> Tensor:
        """Return the actor's latent."""
        return self.policy_net(features)

    def forward_critic(self, features: Tensor) -> Tensor:
        """Return the critic's latent."""
        return self.value_net(features)


class BentActorCriticPolicy(ActorCriticPolicy):
    """PPO's policy with a direct path from the features to the mean action."""

    def _build_mlp_extractor(self) -> None:
        hidden = tuple(self.net_arch)  # type: ignore[arg-type]
        self.mlp_extractor = BentExtractor(self.features_dim, hidden)  # type: ignore[assignment]


class BentSACPolicy(SACPolicy):
    """SAC's policy with a direct path from the features to the mean action."""

    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> SACActor:
        """Return the actor, its hidden layers bent."""
        actor = super().make_actor(features_extractor)
        hidden = tuple(actor.net_arch)
        actor.latent_pi = Bent(actor.features_dim, hidden).to(self.device)  # type: ignore[assignment]
        width = actor.latent_pi.outputs
        actor.mu = nn.Linear(width, actor.mu.out_features).to(self.device)
        nn.init.uniform_(actor.mu.weight, -0.01, 0.01)  # begin near no force
        actor.log_std = nn.Linear(width, actor.mu.out_features).to(self.device)
        return actor


def tanh_layers(inputs: int, hidden: tuple[int, ...]) -> nn.Sequential:
    """Return fully connected tanh layers."""
    layers: list[nn.Module] = []
    for outputs in hidden:
        layers += [nn.Linear(inputs, outputs), nn.Tanh()]
        inputs = outputs
    return nn.Sequential(*layers)


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Where a law has gains of its own; between these nodes they are interpolated.

    Parameters
    ----------
    limits : tuple of float
        Force limits over the scenario's own, rising [-]. One: the law does not see the limit.
    roads, forces : tuple of float
        Amplitudes of road and external force over the nominal ones, rising [-]. They are those of
        the observation, ``sqrt(y^2 + y'^2)`` and ``sqrt(F^2 + F'^2)``.

    Raises
    ------
    ValueError
        If nodes do not rise.
    """

    limits: tuple[float, ...] = (1.0,)
    roads: tuple[float, ...] = (1.0,)
    forces: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        """Check the nodes."""
        for name in ("limits", "roads", "forces"):
            nodes = getattr(self, name)
            if not nodes or any(b <= a for a, b in pairwise(nodes)):
                raise ValueError(f"{name} must rise, got {nodes}; give each node once, in order")

    @property
    def nodes(self) -> int:
        """Number of nodes of road and force together."""
        return len(self.roads) * len(self.forces)


class Shares(nn.Module):
    """The share of each node at a value: hat functions, constant outside.

    Parameters
    ----------
    nodes : tuple of float
        Where the hats stand, rising.
    """

    def __init__(self, nodes: tuple[float, ...]) -> None:
        super().__init__()
        where = torch.tensor(nodes, dtype=torch.float64)  # as the compiled law: gains differ a lot
        self.register_buffer("nodes", where)
        self.register_buffer("rising", torch.cat([torch.ones(1), where.diff()]))
        self.register_buffer("falling", torch.cat([where.diff(), torch.ones(1)]))

    def forward(self, value: Tensor) -> Tensor:
        """Return the shares (n, len(nodes)), in double precision, at values (n, 1)."""
        held = torch.clamp(value.double(), self.nodes[0], self.nodes[-1])  # type: ignore[index]
        up = 1.0 + (held - self.nodes) / self.rising  # type: ignore[operator]
        down = 1.0 - (held - self.nodes) / self.falling  # type: ignore[operator]
        return torch.clamp(torch.minimum(up, down), 0.0, 1.0)


class LawNet(nn.Module):
    """The policy of search and analytic gradients: clip(linear law + small network).

    Parameters
    ----------
    observation_space : gymnasium.spaces.Box
        Space of the raw observation.
    features : FeatureMap
        What the small network sees.
    hidden : tuple of int
        Widths of its layers; empty for a linear law.
    actions : int
        Number of actuators.
    schedule : Schedule
        Where the law has gains of its own (gain scheduling).

    Notes
    -----
    The gains are ``sinh`` of the parameters, so that one search step of order one covers gains
    from below 1 to 1000. With gains that high the sum is made in double precision, or its rounding
    would show in the action. Between limits the parameters are interpolated, as the gains there
    differ by orders of magnitude; between amplitudes of road and force the gains themselves.
    """

    def __init__(
        self,
        observation_space: gym.Space[Any],
        features: FeatureMap,
        hidden: tuple[int, ...],
        actions: int,
        schedule: Schedule | None = None,
    ) -> None:
        super().__init__()
        schedule = Schedule() if schedule is None else schedule
        size = observation_space.shape[0]  # type: ignore[index]
        count = len(schedule.limits)
        self.inputs = size - 1 if count > 1 else size
        self.gains = nn.Parameter(torch.zeros(count, schedule.nodes, actions, self.inputs))
        self.limits = Shares(schedule.limits) if count > 1 else None
        self.roads: Shares | None = None
        self.forces: Shares | None = None
        if schedule.nodes > 1:
            if self.inputs < task.FULL_SIZE:
                raise ValueError(
                    "a law scheduled on road and force must see them, got an observation of "
                    f"{size} entries; give observe='full' or one node"
                )
            self.roads, self.forces = Shares(schedule.roads), Shares(schedule.forces)
        self.features: Features | None = None
        self.bend: nn.Module | None = None
        if hidden:
            self.features = Features(observation_space, features)
            out = nn.Linear(hidden[-1], actions)
            nn.init.zeros_(out.weight)
            nn.init.zeros_(out.bias)
            self.bend = nn.Sequential(*tanh_layers(self.features.features_dim, hidden), out)

    def begin_at_velocity_feedback(self, parameter: float) -> None:
        """Let each actuator work against a velocity: a single one against the body's."""
        actions = self.gains.shape[2]
        with torch.no_grad():
            for i in range(actions):
                self.gains[..., i, task.FEEDBACK_SIZE - actions + i] = -parameter

    def command(self, observation: Tensor) -> Tensor:
        """Return the action before it is clipped, shape (n, m)."""
        x = observation[:, : self.inputs].double()
        gains = self._gains(observation)
        if gains.shape[0] == 1:
            u = x @ gains[0].T
        else:
            u = torch.sum(gains * x[:, None, :], dim=2)
        u = u.to(observation.dtype)
        if self.bend is not None and self.features is not None:
            u = u + self.bend(self.features(observation))
        return u

    def forward(self, observation: Tensor) -> Tensor:
        """Return the action, shape (n, m), of raw observations (n, k)."""
        return torch.clamp(self.command(observation), -1.0, 1.0)

    def _gains(self, observation: Tensor) -> Tensor:
        """Return the gains (n or 1, m, inputs) at limit, road and force of the observations."""
        count, nodes, actions, inputs = self.gains.shape
        parameters = self.gains.double()
        if self.limits is not None:
            share = self.limits(observation[:, -1:])
            parameters = (share @ parameters.reshape(count, -1)).reshape(-1, nodes, actions, inputs)
        gains = 0.5 * (torch.exp(parameters) - torch.exp(-parameters))  # ONNX: sinh of float32 only
        if self.roads is None or self.forces is None:
            return gains[:, 0]
        world = observation[:, task.FEEDBACK_SIZE : task.FULL_SIZE].double()
        road = self.roads(torch.sqrt(torch.sum(world[:, 0:2] * world[:, 0:2], dim=1, keepdim=True)))
        force = self.forces(
            torch.sqrt(torch.sum(world[:, 2:4] * world[:, 2:4], dim=1, keepdim=True))
        )
        share = (road[:, :, None] * force[:, None, :]).reshape(-1, nodes)
        return torch.sum(share[:, :, None, None] * gains, dim=1)


class Deterministic(nn.Module):
    """What is exported of an SB3 policy: raw observation to mean action, without its distribution.

    Parameters
    ----------
    policy : BasePolicy
        PPO's, SAC's (or TQC's), or TD3's policy.
    """

    def __init__(self, policy: BasePolicy) -> None:
        super().__init__()
        if isinstance(policy, ActorCriticPolicy):
            self.features = policy.pi_features_extractor
            self.latent = policy.mlp_extractor.policy_net
            self.head = policy.action_net
            self.squash = False
        elif isinstance(policy, TD3Policy):
            actor = policy.actor
            assert isinstance(actor, TD3Actor)
            self.features, self.latent, self.head = actor.features_extractor, actor.mu, None
            self.squash = False
        else:
            actor = policy.actor  # type: ignore[union-attr]
            self.features = actor.features_extractor
            self.latent, self.head = actor.latent_pi, actor.mu
            self.squash = True

    def forward(self, observation: Tensor) -> Tensor:
        """Return the action, shape (n, m), of raw observations (n, k)."""
        found = self.latent(self.features(observation))
        if self.head is not None:
            found = self.head(found)
        return torch.tanh(found) if self.squash else torch.clamp(found, -1.0, 1.0)
