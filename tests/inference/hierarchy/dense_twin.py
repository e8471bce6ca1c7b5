"""The same model written plainly: one covariance over every trial, one multivariate normal."""

from __future__ import annotations

import numpy as np
from scipy import stats


def trial_covariance(subject, environment, x, scales, w, *, alpha_sd, gamma_sd):
    """Dense covariance of the stacked trials (trial-major, parameter inner) for draw `w`."""
    trials, size = len(subject), len(x)
    named = {key: value[..., w] for key, value in scales.named.items()}
    rho_w, rho_e, rho_u = (named.get(key, 0.0) for key in ("rho_w", "rho_e", "rho_u"))
    covariance = np.zeros((trials, size, trials, size))
    for m in range(trials):
        for n in range(trials):
            i, j, k, h = subject[m], environment[m], subject[n], environment[n]
            for p in range(size):
                covariance[m, p, n, p] += alpha_sd**2
                if "tau" in named:
                    covariance[m, p, n, p] += gamma_sd**2 * x[p, j] * x[p, h]
                    covariance[m, p, n, p] += (j == h) * named["tau"][p] ** 2
            for p in range(size):
                for q in range(size):
                    same = p == q
                    if i == k and "sigma_u" in named:
                        sigma_u = named["sigma_u"]
                        covariance[m, p, n, q] += (1.0 if same else rho_u) * sigma_u[p] * sigma_u[q]
                    if i == k and j == h:
                        sigma = named["sigma"][:, j]
                        covariance[m, p, n, q] += (1.0 if same else rho_w) * sigma[p] * sigma[q]
                    if m == n and "sigma_e" in named:
                        sigma = named["sigma_e"][:, j]
                        covariance[m, p, n, q] += (1.0 if same else rho_e) * sigma[p] * sigma[q]
    return covariance.reshape(trials * size, trials * size)


def log_likelihood(response, subject, environment, x, scales, w, *, alpha_sd=1.0, gamma_sd=0.25):
    covariance = trial_covariance(
        subject, environment, x, scales, w, alpha_sd=alpha_sd, gamma_sd=gamma_sd
    )
    flat = np.asarray(response).ravel()
    return stats.multivariate_normal(np.zeros(flat.size), covariance, allow_singular=False).logpdf(
        flat
    )


def log_prior(named, x, w, priors):
    """Prior density of the original variables (log SDs and log s, not coordinates) at draw `w`."""
    named = {key: value[..., w] for key, value in named.items()}
    total = 0.0
    trend = "tau" in named
    for suffix in ("", "_e"):
        if "sigma" + suffix not in named:
            continue
        log_sigma = np.log(named["sigma" + suffix])
        mean, sd = getattr(priors, f"log_s{suffix}_mean"), getattr(priors, f"log_s{suffix}_sd")
        if not trend:
            total += stats.norm.logpdf(log_sigma, mean, sd).sum()
            continue
        log_s = np.log(named["s" + suffix])
        total += stats.norm.logpdf(log_s, mean, sd).sum()
        kappa = np.zeros(len(x))
        if "kappa" + suffix in named:
            kappa = named["kappa" + suffix]
            total += stats.norm.logpdf(kappa, 0, getattr(priors, f"kappa{suffix}_sd")).sum()
        if "omega" + suffix in named:
            omega = named["omega" + suffix]
            total += stats.halfnorm.logpdf(
                omega, scale=getattr(priors, f"omega{suffix}_scale")
            ).sum()
            centre = log_s[:, None] + kappa[:, None] * x
            total += stats.norm.logpdf(log_sigma, centre, omega[:, None]).sum()
    for name in ("rho_w", "rho_e", "rho_u"):
        if name in named:
            shape = priors.rho_shape
            total += stats.beta.logpdf((named[name] + 1) / 2, shape, shape) - np.log(2)
    if trend:
        total += stats.halfnorm.logpdf(named["tau"], scale=priors.tau_scale).sum()
    if "sigma_u" in named:
        total += stats.halfnorm.logpdf(named["sigma_u"], scale=priors.sigma_u_scale).sum()
    return total


def prior_variables(named, *, common_spread):
    """The variables of `log_prior` as one vector per draw, (dimension, W)."""
    trend = "tau" in named
    parts = []
    for name, value in named.items():
        derived = name.startswith("sigma") and name != "sigma_u" and trend and common_spread
        if not derived:
            logged = name in ("s", "s_e", "sigma", "sigma_e")
            parts.append((np.log(value) if logged else value).reshape(-1, value.shape[-1]))
    return np.concatenate(parts)
